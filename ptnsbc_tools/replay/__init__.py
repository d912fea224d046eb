"""`ptnsbc bag replay`: a bag through the controllers again, or back onto its topics."""
