"""`trimtab doctor`: what of Trimtab works on this machine and in this workspace."""
