"""What a run leaves: formed sheets, history, certificate, files."""
