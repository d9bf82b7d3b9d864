"""Pictures of results, and a view to turn in the browser."""
