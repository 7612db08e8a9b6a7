"""Identification judged by MuJoCo: `trials`, data of twins whose parameters are known."""
