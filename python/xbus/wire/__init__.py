"""Single frames, messages, packets and strings, and the link that transfers their bytes."""
