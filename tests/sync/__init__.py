"""The API without await."""
