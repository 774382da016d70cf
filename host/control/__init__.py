"""Host-side controllers: they command body rate and collective thrust over the link."""
