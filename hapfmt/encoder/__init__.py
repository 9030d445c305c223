"""One opinion: which knots, which step, which codec. Nothing on the decode side comes here."""
