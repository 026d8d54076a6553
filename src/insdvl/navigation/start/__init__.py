"""How the state starts: as it is told, from the first message, or from a vehicle at rest."""
