"""The Python API: one file a stage, what the commands call and `thermaltool` offers."""
