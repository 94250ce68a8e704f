"""The contact solver: phases over constraint records, from position correction to the energy audit."""
