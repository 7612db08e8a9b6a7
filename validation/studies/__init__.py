"""Many closed loops: the paper's experiments and what goes beyond them."""
