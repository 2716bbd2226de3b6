"""rosbridge clients: the protocol, the graph of topics and services, and the nodes on it."""
