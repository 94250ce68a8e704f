"""`carom contacts --statistics`: statistics of the impacts, contacts and velocities of a recording."""
