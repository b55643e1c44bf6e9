"""The site: the ledger, every run, every component and the handbook as pages for a browser."""
