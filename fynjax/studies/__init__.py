"""Studies of one data set each, built on the package."""
