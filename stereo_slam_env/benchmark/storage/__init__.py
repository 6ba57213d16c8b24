"""Run directories: results are written as trials finish, and read back."""
