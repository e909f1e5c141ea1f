"""A jointed structure of any dimension: a body with supports and joints, and its equations."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import InitVar, dataclass, field, replace
from functools import cached_property
from itertools import chain, count
from pathlib import Path
from typing import Any

import numpy as np
from scipy import sparse

from skfem_joint.body.body import Body, Material
from skfem_joint.body.checks import KINDS, wrong_name
from skfem_joint.ground.arrays import BoolArray, FloatArray
from skfem_joint.ground.errors import InputError, refuse
from skfem_joint.ground.loads import Scaled
from skfem_joint.ground.progress import Progress, silent
from skfem_joint.ground.values import NOT_NEGATIVE, problems, several
from skfem_joint.joint import doubts
from skfem_joint.joint.clamps import Clamp, clamp_problems, cuts, unit_clamps
from skfem_joint.joint.contact import contact_rows
from skfem_joint.joint.joints import Joint, joint_problems
from skfem_joint.joint.opening import NodalForces
from skfem_joint.joint.patch import Patch, check_shared, make_patch
from skfem_joint.joint.preload import Preload, TouchingFaces, preload
from skfem_joint.joint.pressure_space import PressureSpace, pressure_space
from skfem_joint.joint.rigid import body_motions, loose_bodies
from skfem_joint.linalg.parts import Parts, parts_problems
from skfem_joint.mesh import NamedMesh, load_meshes, named
from skfem_joint.mesh.cells import pieces
from skfem_joint.mesh.order import of_order
from skfem_joint.structure.doubts import doubted, stiff
from skfem_joint.structure.load import Load, acting, load_problems, under_loads
from skfem_joint.structure.mesh_error import KnownMeshError, MeshError, Straight
from skfem_joint.structure.reactions import Reactions, reactions
from skfem_joint.system.modes import KnownFit, ratio_problems
from skfem_joint.system.slips import SlipRows
from skfem_joint.system.system import AppliedLoad, System
from skfem_joint.system.unknowns import ChangeOfUnknowns, expanded

#: What the body of a structure is made of, beside its mesh.
_OF_BODY = "material", "width", "thickness", "plane", "mass", "regions", "incompatible"


@dataclass(frozen=True)
class Structure:
    """Elastic bodies with supports and joints.

    Attributes
    ----------
    mesh : NamedMesh or skfem.Mesh, or str or Path
        Of dimension 1, 2 or 3, with named regions, boundaries and points; or the name of its
        file, see `load_meshes`.
    material : Material
    width : float, optional
        Of a bar, m; a joint on a bar has this width.
    thickness : float, optional
        Of a bar or a plate, m.
    order : {"auto", 1, 2}
        Order of the displacement. "auto" computes meshes with triangles, tetrahedra or prisms of
        first order, which bend too stiffly, with quadratic displacements on the same mesh; see
        `mesh.order.of_order`.
    plane : {"stress", "strain"}
        State of a plate across its plane: stress for plates that are thin and loaded in their
        plane, strain for slices of bodies that are long across it.
    fixed, fixed_x, fixed_y, fixed_z : sequence of str
        Regions, boundaries and points that are held in all directions or in one.
    joints : sequence of Joint
    bolts : sequence of Clamp
        That press the joints with ``pressure = "preload"``.
    stiffness_damping, mass_damping : float
        C = stiffness_damping K + mass_damping M, in s and 1/s.
    damping_ratio : float, optional
        Share of the critical damping, in place of these two: see `System.with_damping_ratio`.
    mass : {"consistent", "lumped"}
        Integrals of products of shape functions, or their row sums on the diagonal.
    regions : mapping
        ``{region: {"E": ..., "thickness": ...}}``: values that differ in a region.
    incompatible : bool
        Whether quadrilaterals and hexahedra of first order have incompatible modes, without which
        they bend too stiffly; see `Body`.
    free : bool
        Whether bodies may float; otherwise bodies without any support are refused.
    parts : Parts, optional
        In which the stiffness is factorised one by one for the preload, where its whole factor
        takes too much memory.
    like : Structure, optional
        Whose body, matrices and preload are taken over as far as the same values make them; see
        `with_values`.
    progress : callable, optional
        Called while bolts are tightened, as by `tighten`; not of structures that are ``free``,
        whose bolts are tightened when that is asked for.
    body : Body
        The elastic bodies alone, made from the values above.
    fitted : KnownFit
        The last frequencies at which damping had its ratio.
    erring : KnownMeshError
        The last error by the mesh.

    Raises
    ------
    InputError
        For values out of range, names that the mesh does not have or that are of another kind,
        joints that overlap or whose bodies do not, and bodies without any support.
    """

    mesh: NamedMesh
    material: Material
    width: float | None = None
    thickness: float | None = None
    plane: str = "stress"
    fixed: Sequence[str] = ()
    fixed_x: Sequence[str] = ()
    fixed_y: Sequence[str] = ()
    fixed_z: Sequence[str] = ()
    joints: Sequence[Joint] = ()
    bolts: Sequence[Clamp] = ()
    stiffness_damping: float = 0.0
    mass_damping: float = 0.0
    damping_ratio: float | None = None
    mass: str = "consistent"
    regions: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    incompatible: bool = True
    free: bool = False
    order: int | str = "auto"
    parts: Parts | None = field(default=None, repr=False, compare=False)
    like: InitVar[Structure | None] = None
    progress: InitVar[Progress] = silent
    body: Body = field(init=False, repr=False, compare=False)
    fitted: KnownFit = field(init=False, repr=False, compare=False, default_factory=KnownFit)
    _order_notes: list[str] = field(init=False, repr=False, compare=False, default_factory=list)
    erring: KnownMeshError = field(
        init=False, repr=False, compare=False, default_factory=KnownMeshError
    )
    _faces: TouchingFaces | None = field(init=False, repr=False, compare=False, default=None)

    def __post_init__(self, like: Structure | None, progress: Progress) -> None:
        given: object = self.mesh
        if isinstance(given, str | Path):
            object.__setattr__(self, "mesh", load_meshes(given))
        elif not isinstance(given, NamedMesh):
            object.__setattr__(self, "mesh", named(given))
        how = {"lumped": self.mass == "lumped", "in_parts": self.parts is not None}
        mesh, notes = of_order(self.mesh, self.order, **how)
        object.__setattr__(self, "mesh", mesh)
        self._order_notes.extend(notes)
        kinds = {"joints": Joint, "bolts": Clamp}
        for name in ("fixed", "fixed_x", "fixed_y", "fixed_z", "joints", "bolts"):
            each = several(name, getattr(self, name), kinds.get(name, object))
            object.__setattr__(self, name, each)
        wrong = parts_problems(self.parts)
        try:
            body = None if like is None else like._body_for(self)
            values = {name: getattr(self, name) for name in _OF_BODY}
            object.__setattr__(self, "body", body or Body(self.mesh, **values))
        except InputError as error:
            wrong += error.problems
        wrong += [*self._damping_problems(), *self._support_problems()]
        if self.mesh.plane not in ("", self.plane):
            wrong.append(
                f"plane: found {self.plane!r}, but the elements of the mesh file are of plane "
                f"{self.mesh.plane}: give plane = {self.mesh.plane!r}, in [section] of a scene, or "
                "save them as the other type"
            )
        wrong += joint_problems(self.mesh, self.joints)
        refuse(wrong or clamp_problems(self.mesh, self.joints, self.bolts))
        if like is not None:
            like._hand_over(self)
        if not self.free:
            self.tighten(progress)
            refuse(
                f"{label} is left unsupported: it can move or turn freely; hold it by a support, "
                "or by a joint with friction on a body that is held"
                for label in loose_bodies(self.body, self.held, self.patches, self.cuts)
            )

    def _body_for(self, other: Structure) -> Body | None:
        """Body of this structure, if another one has the same; else None."""
        same = all(getattr(self, name) == getattr(other, name) for name in _OF_BODY)
        return self.body if same and self.mesh is other.mesh else None

    def _hand_over(self, other: Structure) -> None:
        """Give another structure what is known already and the same for both."""
        for name in ("fitted", "erring"):
            object.__setattr__(other, name, getattr(self, name))

        def pressed(structure: Structure) -> list[Any]:
            faces = (
                (j.on, j.against, j.gap, j.remove_plane, j.pressed_by_bolts)
                for j in structure.joints
            )
            return [*faces, *(replace(bolt, force=1.0) for bolt in structure.bolts)]

        def forced(structure: Structure) -> list[Any]:
            return [*structure.bolts, *(j.gap_scale for j in structure.joints)]

        if self.mesh is not other.mesh or not np.array_equal(self.held, other.held):
            return
        known = vars(self).get("preload")
        if known is None or pressed(self) != pressed(other):
            return
        if all(
            np.array_equal(self.body.properties[name], other.body.properties[name])
            for name in ("width", "thickness")
        ):
            object.__setattr__(other, "_faces", known.faces)
        if other.body is self.body and forced(self) == forced(other):
            vars(other)["preload"] = known

    def _damping_problems(self) -> list[str]:
        """What is wrong with the damping."""
        factors = {"stiffness": self.stiffness_damping, "mass": self.mass_damping}
        wrong: list[str] = []
        for name, value in factors.items():
            wrong += problems(f"damping.{name}", value, NOT_NEGATIVE)
        if self.damping_ratio is not None:
            wrong += ratio_problems(self.damping_ratio, factors)
        return wrong

    def _support_problems(self) -> list[str]:
        """What is wrong with the names and directions of supports."""
        wrong: list[str] = []
        for key in ("fixed", "fixed_x", "fixed_y", "fixed_z"):
            names = getattr(self, key)
            for name in names:
                wrong += wrong_name(self.mesh, name, KINDS, f"support.{key}")
            if names and key[-1] in "xyz"[self.dim :]:
                wrong.append(f"support.{key}: this mesh has no {key[-1]} direction")
        return wrong

    @property
    def dim(self) -> int:
        """Dimension of the mesh, 1, 2 or 3."""
        return self.mesh.dim

    @property
    def nodes(self) -> FloatArray:
        """Positions of the displacement nodes in the mesh's coordinates, (N, dim), m."""
        return self.body.nodes

    @property
    def n_nodes(self) -> int:
        """Number of displacement nodes N."""
        return self.body.n_nodes

    @property
    def n_dofs(self) -> int:
        """Number of degrees of freedom, ``dim * node + component``, supported ones included."""
        return self.dim * self.n_nodes

    @property
    def positions(self) -> FloatArray:
        """Positions of the nodes in space, (N, 3), m."""
        return self.body.positions

    def matrices(self) -> tuple[sparse.csr_array, sparse.csr_array]:
        """Mass (kg) and stiffness (N/m) of all nodes, before supports and contact."""
        return self.body.matrices()

    def stress(self, displacement: FloatArray) -> FloatArray:
        """Mean elastic stress of each element, from the displacement of all nodes, (N, dim), m.

        Returns
        -------
        ndarray, shape (elements, 6)
            Components XX, YY, ZZ, XY, YZ and XZ in space, Pa.
        """
        return self.body.stress(displacement)

    @property
    def identity(self) -> list[Any]:
        """Arrays and names that distinguish this mesh from another."""
        return self.mesh.identity

    def meshed(self, purpose: str) -> Structure:
        """Return the structure itself: its geometry is known, whatever the purpose."""
        return self

    def overview(self) -> str:
        """Sentence about what the structure is made of."""
        bodies, kinds = int(self.mesh.body.max()) + 1, ""
        if len(self.mesh.parts) > 1:
            each = (f"{part.elements.size} {part.kind.plural}" for part in self.mesh.parts)
            kinds = f", {' and '.join(each)}"
        return (
            f"{bodies} {'body' if bodies == 1 else 'bodies'}, {self.mesh.n_elements} elements of "
            f"order {self.mesh.order}{kinds}."
        )

    def at_rest(self) -> list[str]:
        """Sentences about the preload, and about bodies that friction alone holds."""
        loose = loose_bodies(self.body, self.held, self.patches, self.cuts, friction=False)
        pressed, creep = self.preload, ", and creeps under the arctan law"
        steep = all(np.isinf(patch.joint.beta) for patch in self.patches)
        return [
            *doubts.resolved_gaps(self.joints, self.spaces),
            *(() if pressed is None else pressed.sentences(self.joints, self.bolts)),
            *(
                f"Friction alone holds {label}: it may slip away{'' if steep else creep}."
                for label in loose
            ),
        ]

    @cached_property
    def unusual(self) -> list[str]:
        """Sentences about mesh, values and size that suggest a mistake of the user."""
        return [
            *self.mesh.notes,
            *self._order_notes,
            *doubts.unusual_values(self.body),
            *doubts.wider_than_other(self.body, self.joints),
            *doubts.doubtful_gaps(self.joints, self.spaces),
            *stiff(self.body, self.mesh_error, in_parts=self.parts is not None),
        ]

    @cached_property
    def mesh_error(self) -> MeshError | None:
        """Error of the first frequencies by the mesh, with the joints stuck.

        With the joints loose where none carries friction, or where they hold everything. None of
        bars, of elements of second order, whose errors are small, of structures in parts, and of
        meshes so large that it would take much memory.
        """
        return self._erring("stuck")

    @cached_property
    def loose_mesh_error(self) -> MeshError | None:
        """The same with the joints loose."""
        return self._erring("loose")

    def _erring(self, joints: str) -> MeshError | None:
        """Error of the first frequencies by the mesh, with the joints stuck or loose."""
        if self.dim == 1 or self.mesh.order > 1 or self.parts is not None:
            return None
        every, mesh = tuple(range(self.dim)), self.mesh
        straight = [Straight(*support) for support in self._supports]
        for joint in self.joints:
            faces = [name for name in (joint.on, joint.against) if name is not None]
            # Loose joints of faces hold them across the face, those of regions not at all.
            straight += [Straight(name, every, name in mesh.boundaries) for name in faces]
        straight += [Straight(name, every) for bolt in self.bolts for name in bolt.shank or ()]
        return self.erring(self.body, self.unloaded.closed(), straight, joints)

    def spot(self, dof: int) -> str:
        """The node of a degree of freedom in a message."""
        node = dof // self.dim
        return f"node {node}, at ({', '.join(f'{x:.6g}' for x in self.nodes[node])}) m"

    @cached_property
    def held(self) -> BoolArray:
        """Whether a support holds each displacement, (N, dim)."""
        held = np.zeros((self.n_nodes, self.dim), dtype=bool)
        for name, components in self._supports:
            held[self.body.nodes_of(name)[:, np.newaxis], components] = True
        return held

    @property
    def _supports(self) -> list[tuple[str, tuple[int, ...]]]:
        """Name of each part that is held, and the components of its displacement that are."""
        ways = [(self.fixed, tuple(range(self.dim)))]
        ways += [(self.fixed_x, (0,)), (self.fixed_y, (1,)), (self.fixed_z, (2,))]
        return [(name, components) for names, components in ways for name in names]

    @cached_property
    def preload(self) -> Preload | None:
        """Static solution under the clamp forces; None without clamping bolts."""
        return self._tightened() if self.bolts else None

    def tighten(self, progress: Progress = silent) -> None:
        """Find the preload now, and not when it is first asked for.

        ``progress`` is called with the number of sets of touching nodes that were tried, 0, and a
        note. Errors as for the structure.
        """
        if self.bolts and "preload" not in vars(self):
            vars(self)["preload"] = self._tightened(progress)

    def _tightened(self, progress: Progress = silent) -> Preload:
        """Static solution under the clamp forces; what is wrong without it is refused before."""
        like = self._faces
        clamps = like.clamps if like else unit_clamps(self.body, self.bolts)
        _ = self.cuts, self._patches(None)  # which refuse what is wrong
        solved = self.body, self.held, self.joints, self.bolts, clamps, self.spaces
        return preload(*solved, like, progress, self.parts)

    @cached_property
    def spaces(self) -> Mapping[int, PressureSpace]:
        """Pressures of the joints that open, or of all with clamping bolts, by their numbers."""
        if self._faces is not None:
            return self._faces.spaces
        spaces: dict[int, PressureSpace] = {}
        wrong: list[str] = []
        for i, joint in enumerate(self.joints):
            try:
                space = pressure_space(self.body, joint) if joint.opens or self.bolts else None
            except InputError as error:
                wrong += error.problems
                continue
            if space is not None:
                spaces[i] = space
        refuse(wrong)
        return spaces

    @cached_property
    def patches(self) -> tuple[Patch, ...]:
        """Contact points of each joint."""
        if self.preload is None:
            return self._patches([None] * len(self.joints))
        return self._patches(self.preload.joints)

    def _patches(self, pressed: Sequence[NodalForces | None] | None) -> tuple[Patch, ...]:
        """Contact points of joints that are pressed so.

        Before a preload, without ``pressed``, those whose contact points do not depend on it: all
        nodes of faces that open, and of joints with a pressure of their own.
        """
        wrong: list[str] = []
        patches: list[Patch] = []
        numbering = np.full(self.n_nodes, -1, dtype=np.intp)
        for i, joint in enumerate(self.joints):
            try:
                known = pressed[i] if pressed else None, self.spaces.get(i)
                patch = make_patch(self.body, joint, self.held, numbering, *known)
                check_shared(self.body, patches, patch)
                patches.append(patch)
            except InputError as error:
                wrong += error.problems
        refuse(wrong)
        return tuple(patches)

    @cached_property
    def _slip_rows(self) -> SlipRows:
        """Slip rows of all joints, and rows that hold cut shanks together."""
        return contact_rows(self.patches, self.held) + self.cuts

    @cached_property
    def cuts(self) -> SlipRows:
        """Rows that hold cut shanks together."""
        return cuts(self.body, self.held, self.bolts)

    @cached_property
    def change_of_unknowns(self) -> ChangeOfUnknowns:
        """Unknowns from the displacements of all nodes, ``dim * node + component``, and back."""
        rows, fixed = self._slip_rows, np.flatnonzero(self.held)
        return rows.change_of_unknowns(fixed)

    @property
    def T(self) -> sparse.csr_array:
        """Displacement of all nodes from the unknowns, (dim N, n)."""
        return self.change_of_unknowns.forward

    def expand(self, u: FloatArray) -> FloatArray:
        """Displacement of all nodes, (..., N, dim), from that of the unknowns, (..., n)."""
        return self.unpacked(expanded(self.T, u))

    def unpacked(self, x: FloatArray) -> FloatArray:
        """Vectors of all nodes, (..., N, dim), from what `System.expand` gives, (..., dim N)."""
        return self.body.unpacked(x)

    def system(
        self,
        loads: Sequence[Load] = (),
        points: Sequence[str] | None = None,
        *,
        quasi_static: bool = False,
    ) -> System:
        """Sparse system of equations under loads.

        ``P`` first has a row for each load, named after the part that it acts on: the displacement
        in the work of the load. A load at the same place in another direction has ".2" added to its
        name, and so on. Rows of the observed displacements follow: "name" in one dimension, else
        "name.x" and so on, with ".2" where a load against the x-axis has that name.

        An accelerated base is replaced by the inertia force of all mass (N), named "mass_x"; its
        displacement is the mean weighted by mass. A traction or pressure is replaced by its force
        on the whole area (N); the displacement of a pressure is the mean displacement inwards.

        Parameters
        ----------
        loads : sequence of Load
        points : sequence of str, optional
            Names of observed points, boundaries and regions, the latter two by their mean
            displacement. All points that can move, if not given.
        quasi_static : bool
            Whether the loads change slowly: then no notes are about waves and impacts.

        Returns
        -------
        System
            Its ``notes`` say what suggests a mistake in mesh, values, loads and joints.

        Raises
        ------
        InputError
            For unknown names, directions that do not fit, and loads on parts that cannot move.
        """
        loads = several("loads", loads, Load)
        points = None if points is None else several("points", points)
        refuse(load_problems(self.mesh, loads, points))
        T, (M, _) = self.T, self.matrices()
        wrong: list[str] = []
        rows: dict[str, FloatArray] = {}
        applied: list[AppliedLoad] = []
        notes = [*doubts.faces_apart(self.body, self.patches)]
        for load in loads:
            on = load.on or f"mass_{load.base}"
            full, scale, note = acting(self.body, load, M)
            vector, amplitude = T.T @ full, load.amplitude
            if note:
                notes += note
                amplitude = Scaled(amplitude, scale)
            if not np.any(vector):
                pressed = load.quantity == "pressure"
                along = "its normal" if pressed else load.unit(self.dim).tolist()
                wrong.append(
                    f"{load.label}: a support holds it along {along}, a force there does nothing; "
                    "load a free part"
                )
            name = _free_name(on, full, rows)
            rows[name] = full
            mass = -scale if load.base is not None else 0.0
            applied.append(AppliedLoad(vector, amplitude, name, mass))
        for name in self.free_points if points is None else dict.fromkeys(points):
            shares = self.body.even_shares(name)
            parts = [np.outer(shares, axis).ravel() for axis in np.eye(self.dim)]
            if not np.any([T.T @ part for part in parts]):
                wrong.append(f"points: {name!r} is supported and does not move")
            labels = [name] if self.dim == 1 else [f"{name}.{c}" for c in "xyz"[: self.dim]]
            for label, part in zip(labels, parts, strict=True):
                rows[_free_name(label, part, rows)] = part
        refuse(wrong)
        for k, load in enumerate(loads):
            if load.base is not None:
                moves = np.tile(load.unit(self.dim), self.n_nodes)
                carried = np.array([row @ moves for row in rows.values()])
                applied[k] = replace(applied[k], carried=carried)
        damping = self.damping_ratio, notes, self.fitted
        of_unknowns = {name: T.T @ row for name, row in rows.items()}
        system = under_loads(self.unloaded, self.patches, applied, of_unknowns, *damping)
        doubtful = self.unusual, self.patches, self.body
        return doubted(system, *doubtful, quasi_static=quasi_static)

    def reactions(self, loads: Sequence[Load]) -> Reactions | None:
        """Change of the normal forces by vibration; None where no contact is closed."""
        rows = self._slip_rows
        if rows.pivots is None or not rows.clamped.any():
            return None
        M, K = self.matrices()
        F = np.stack([acting(self.body, load, M)[0] for load in loads], axis=1)
        cells = np.vstack([patch.cells for patch in self.patches if patch.normal is not None])
        # Stand for each node by the degree of freedom that closed contact determines.
        dof = np.arange(self.n_nodes) * self.dim
        determined = rows.pivots[: rows.closed.shape[0]]
        dof[determined // self.dim] = determined
        fixed = np.flatnonzero(self.held)
        return reactions(rows, fixed, (M, K), self.T, F, dof[cells])

    def pressed_at(self, dof: int) -> str:
        """Joint and node of a degree of freedom that closed contact determines, in a message."""
        names = [p.joint.name for p in self.patches if dof // self.dim in p.nodes]
        return f"joint {names[0]} around {self.spot(dof)}"

    @property
    def free_points(self) -> tuple[str, ...]:
        """Names of the points that can move."""
        moves = np.diff(self.T.indptr[:: self.dim]) > 0
        return tuple(name for name, node in self.mesh.points.items() if moves[node])

    @cached_property
    def unloaded(self) -> System:
        """System without loads, observed points and names of joints."""
        rows, new = self._slip_rows, self.change_of_unknowns
        M, K = self.body.in_unknowns(self.T)
        # A sum of sparse arrays keeps memory for as many entries as both have.
        C = sparse.csr_array(self.stiffness_damping * K + self.mass_damping * M).copy()
        return System(
            M=M,
            C=C,
            K=K,
            contact=rows.contact_in(new),
            T=new.forward,
            loose=self._loose,
        )

    @property
    def _loose(self) -> sparse.csr_array | None:
        """Rigid motions of each body in the unknowns, (n, r); see `System.loose`.

        Not known of bodies of which parts share single nodes or edges, about which they turn.
        """
        if pieces(self.mesh.mesh) > int(self.mesh.body.max()) + 1:
            return None
        motions = sparse.csr_array(body_motions(self.body).reshape(self.n_dofs, -1))
        return sparse.csr_array(self.change_of_unknowns.inverse @ motions)


def _free_name(on: str, vector: FloatArray, rows: Mapping[str, FloatArray]) -> str:
    """Name of a row: ``on``, or with a number where another direction has that name."""
    names = chain([on], (f"{on}.{number}" for number in count(2)))
    return next(n for n in names if n not in rows or np.array_equal(rows[n], vector))
