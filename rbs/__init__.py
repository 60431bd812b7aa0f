"""The rooms of the rigid-body simulation."""
