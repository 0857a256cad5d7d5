"""What watches a run and changes nothing of it: balance, tearing, rest."""
