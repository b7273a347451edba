"""From a domain to maps: settings → plan → state → phases → engine → views. One folder each, in this order."""
