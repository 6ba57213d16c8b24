"""Error definitions: one file each, all `ErrorDefinition`."""
