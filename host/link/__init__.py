"""The host's side of the link: client, flight director, ports, and the vehicles they fly."""
