"""Time-constant spectrum of a thermal transient: lines, intervals, Foster and Cauer networks."""
