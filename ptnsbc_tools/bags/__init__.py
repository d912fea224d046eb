"""`ptnsbc bag`: what is in a bag, and making one whole again."""
