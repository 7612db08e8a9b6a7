"""The commands, one per file: arguments, one call, its result."""
