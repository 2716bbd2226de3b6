"""Telemetry for users: samples, subscriptions, newest values, the aircraft's clock."""
