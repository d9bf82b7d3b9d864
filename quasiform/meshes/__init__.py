"""Files of meshes: every element is used, or counted by its kind."""
