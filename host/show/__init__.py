"""The content of `trimtab show`: flights, plans and models as data for one interactive page."""
