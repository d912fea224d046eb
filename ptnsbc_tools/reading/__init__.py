"""Bags and headless flights as recordings that can be judged and shown."""
