"""`ptnsbc report`: a recorded flight as one page that needs no network."""
