"""The interface of filters, and what goes in and out of them."""
