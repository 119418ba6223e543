"""Grey box: networks of heat capacities and conductances, stochastic, by Kalman likelihood."""
