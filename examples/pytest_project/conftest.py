pytest_plugins = ["m100link.testing"]
