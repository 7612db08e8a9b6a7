"""One command a file: arguments, one call, its result."""
