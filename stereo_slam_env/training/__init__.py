"""Training a network to look where it learns most: the task, PPO, and what it leaves behind. Needs the extra rl."""
