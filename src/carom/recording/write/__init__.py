"""Frames on their way into a file: encoder, batch queue, stream and durable sink."""
