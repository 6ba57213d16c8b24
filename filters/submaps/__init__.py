"""Large maps: conditionally independent submaps (Paz et al. 2008; Pinies and Tardos 2008)."""
