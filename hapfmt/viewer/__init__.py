"""A recording in the browser: one page, a local server, an overview of whole files."""
