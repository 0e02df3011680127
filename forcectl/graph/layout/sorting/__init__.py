"""The order in the columns, in which few wires cross and bend."""
