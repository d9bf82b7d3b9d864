"""Other codes on the same problems: accuracy first, then time. Run by `validation.peers.run`."""
