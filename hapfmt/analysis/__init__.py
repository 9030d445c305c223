"""Recordings for xarray, Dask and Polars: opened without reading samples, read part by part."""
