"""Looking at a flying fleet from beside it: nothing waits for a viewer, and a viewer changes nothing."""
