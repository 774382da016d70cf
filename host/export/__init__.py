"""Plans for vehicles and programs that know nothing of Trimtab: tables, polynomials, bags."""
