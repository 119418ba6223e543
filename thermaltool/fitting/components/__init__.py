"""Many inputs that say much the same: few components of them, through lags, with a ridge."""
