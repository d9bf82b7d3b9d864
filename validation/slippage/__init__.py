"""INSA and UN strips with slip."""
