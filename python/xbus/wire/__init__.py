"""Single frames, messages, packets and strings, and the link that carries their bytes."""
