"""Stability map: scenes x settings, how far each gets and why not farther."""
