"""Learning the policies of both seats, by every protocol that the paper names or implies."""
