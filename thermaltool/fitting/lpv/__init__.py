"""Linear parameter-varying models: loss rate and gain by levels of an input, powers of inputs."""
