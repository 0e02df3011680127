"""Reading and checking of data files from users: YAML texts, tables of two columns, NetCDF."""
