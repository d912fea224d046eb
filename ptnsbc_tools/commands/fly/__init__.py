"""Commands that fly a swarm or act on one that flies."""
