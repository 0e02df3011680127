"""Force laws and controllers: equations as plain functions, then the systems."""
