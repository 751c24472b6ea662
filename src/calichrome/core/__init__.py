"""Mathematics without pictures: arrays, rigid motions, least squares, findings."""
