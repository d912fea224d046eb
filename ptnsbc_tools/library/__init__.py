"""The names that `import ptnsbc` offers: flights and sweeps as objects with arrays, tables and figures."""
