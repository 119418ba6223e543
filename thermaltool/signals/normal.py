"""What intervals of a normal distribution are made of."""

# Half the width of a 95 % interval in standard errors.
NORMAL_95 = 1.959963984540054
