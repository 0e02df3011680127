"""What people look at: block diagrams and figures."""
