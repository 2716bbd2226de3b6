"""The one owner of an aircraft: connection, lease, journal, orders of clients. Not promised."""
