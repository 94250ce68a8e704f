"""Other engines that run carom's scenes, to be compared with it."""
