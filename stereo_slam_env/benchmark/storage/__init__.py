"""Runs on disk: written as they finish, read by whatever comes later."""
