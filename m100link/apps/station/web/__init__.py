"""HTTP and WebSockets: who is let in, and the server."""
