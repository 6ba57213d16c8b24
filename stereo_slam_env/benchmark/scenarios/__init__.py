"""What is compared on what: scenarios as plain data, from files and as presets."""
