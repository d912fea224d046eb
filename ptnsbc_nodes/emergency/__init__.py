"""The operator's orders to bridges by a path that needs no discovery: sockets in a folder of this host."""
