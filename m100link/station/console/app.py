"""The console as an ASGI application."""
