"""Cases that compare computed values with references; `quasiform validate` runs them."""
