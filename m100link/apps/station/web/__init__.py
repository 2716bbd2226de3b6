"""HTTP and WebSockets: access control, and the server."""
