"""The named filters: their table, the registry of third parties' filters, the options of comparisons."""
