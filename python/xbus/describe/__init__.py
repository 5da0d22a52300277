"""Descriptions of logs, messages and packets: text for people, and plain values for JSON."""
