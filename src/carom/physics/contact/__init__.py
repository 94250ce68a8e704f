"""What happens where spheres touch: found, ordered, resolved."""
