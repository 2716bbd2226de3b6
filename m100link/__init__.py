"""m100link."""
