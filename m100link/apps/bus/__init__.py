"""A network of named messages, questions and tokens: zenoh, or one in memory for tests."""
