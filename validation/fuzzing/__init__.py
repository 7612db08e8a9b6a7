"""Damaged files by the thousand, and what may come of them."""
