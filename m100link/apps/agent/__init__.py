"""The one owner of an aircraft: connection, lease, journal, and what clients may ask for."""
