"""What a stream sends, as it arrives: rates, latest values, attitude and events."""
