"""Data files of others, looked at before they are used: tables of two columns, NetCDF."""
