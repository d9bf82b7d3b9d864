"""Cases that compare computed values with references; `python -m validation.run` runs them."""
