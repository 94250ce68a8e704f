"""Recordings shown: pictures, movies, close-ups, the viewer itself and its page."""
