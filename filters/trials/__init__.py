"""Many independent trials of one filter in lock-step: what a Monte Carlo study spends its time on, vectorised."""
