"""From a domain to maps: settings → kernels → state → phases → planning → engine → views → lights → interreflection.

One folder each. A folder imports only folders before it. factory.py, which makes recoveries, imports from all.
"""
