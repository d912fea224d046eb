"""`ptnsbc network`: profiles of a fleet on several computers."""
