"""The documents' tables (`tables`), written from the figures that stand beside the code."""
