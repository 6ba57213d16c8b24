"""Checks of filters and of parts, for those who write them."""
