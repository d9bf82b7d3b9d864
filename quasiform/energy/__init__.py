"""Energy terms, one file an energy. What a term is stands in `term`."""
