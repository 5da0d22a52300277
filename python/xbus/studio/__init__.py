"""A page in the browser that shows, configures and records devices: ``xbus studio``."""
