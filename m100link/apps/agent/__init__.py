"""The one owner of an aircraft: connection, lease, journal, and the orders of clients."""
