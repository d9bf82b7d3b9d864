"""What is solved: scene files, forming with tools, tests of a fabric."""
