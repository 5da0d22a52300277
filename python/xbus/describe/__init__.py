"""Logs, messages and packets in words, for people, and as plain values, for programs."""
