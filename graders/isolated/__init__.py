"""Reads submissions, and runs them in processes of their own."""
