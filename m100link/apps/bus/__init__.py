"""A network of messages, questions and tokens: zenoh, or one in memory. Not promised."""
