"""Wiring: stations and closed loops put together from the library's blocks. No equations live here."""
