"""What a run or a system shows.

Of runs: `history` (loops, stick and slip, distances between runs), `contact_history` (slip,
friction and work of all contact points), `stress`, `active_region`, `peaks`. Of cycles: `loss`
(energies lost and the loss factor), `places` (what joints and bolts have of them). Of systems:
`natural_modes`, `gross_slip` (the load at which a joint slips as a whole), `normal_force` (what
constant contact leaves out), `contact_mesh` (whether the mesh resolves the slip under bolts).
"""
