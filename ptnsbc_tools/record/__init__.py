"""`ptnsbc record`: a bag of whatever flies."""
