"""From a sequence to a verified program: trajectories, programs, and what explains them."""
