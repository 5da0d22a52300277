"""A package, so that pytest does not confuse its conftest with the one in tests."""
