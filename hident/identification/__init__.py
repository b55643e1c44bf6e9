"""From a record to a model that can be trusted: structures and orders tried, one chosen by other samples."""
