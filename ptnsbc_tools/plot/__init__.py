"""`ptnsbc plot`: figures of a recorded flight as PNG or SVG."""
