"""Section IV-B of the paper: in which submap, and where in it, was a scan taken?"""
