"""What `import ptnsbc` offers: flights and sweeps as objects with arrays, tables and figures."""
