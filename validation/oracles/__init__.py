"""Independent answers: the paper's programmes as printed, a second reading of a file."""
