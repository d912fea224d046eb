"""`ptnsbc stop`: every vehicle of a flying fleet lands, or stops its motors."""
