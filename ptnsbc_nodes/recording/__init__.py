"""Recording topics into bags, and playing bags back onto topics."""
