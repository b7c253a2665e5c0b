# Light in Godot's own pictures against closed forms. A display is needed, one in memory too:
#   xvfb-run godot --path demo --script tests/run.gd
# Without one (--headless) nothing is drawn, and only what needs no picture is tested.
extends SceneTree

var failures := 0
var has_pictures := DisplayServer.get_name() != "headless"

func _initialize() -> void:
	run.call_deferred()

func run() -> void:
	await bakes_tell_how_far_they_are()
	await what_cannot_be_lit_says_why()
	await light_follows_lamps_for_many_frames()
	if has_pictures:
		await a_sphere_round_a_lamp_has_the_light_of_the_closed_form()
		await a_spot_in_a_sphere_fills_it_by_its_flux()
		await what_moves_has_the_light_of_its_place()
		await what_moves_knows_where_light_comes_from()
		await a_wall_by_a_sunlit_floor_has_the_light_of_the_closed_form()
		await a_floor_under_a_bright_panel_and_a_sky()
	print("tests of the node: %s" % ("passed" if failures == 0 else "%d failed" % failures))
	quit(1 if failures > 0 else 0)

func expect(holds: bool, what: String) -> void:
	if not holds:
		failures += 1
		printerr("FAILED: " + what)

func near(found: float, expected: float, share: float, what: String) -> void:
	print("%s: %.4f, expected %.4f" % [what, found, expected])
	expect(absf(found - expected) <= share * absf(expected), what)

# A world of its own, whose pictures are linear.
func world(eye: Vector3, target: Vector3) -> SubViewport:
	var view := SubViewport.new()
	view.size = Vector2i(64, 64)
	view.own_world_3d = true
	view.use_hdr_2d = true
	view.render_target_update_mode = SubViewport.UPDATE_ALWAYS
	var camera := Camera3D.new()
	camera.fov = 10
	camera.near = 0.01
	view.add_child(camera)
	var environment := Environment.new()
	environment.background_mode = Environment.BG_COLOR
	environment.background_color = Color.BLACK
	environment.ambient_light_source = Environment.AMBIENT_SOURCE_DISABLED
	environment.reflected_light_source = Environment.REFLECTION_SOURCE_DISABLED
	environment.tonemap_mode = Environment.TONE_MAPPER_LINEAR
	var own := WorldEnvironment.new()
	own.environment = environment
	own.name = "Environment"
	view.add_child(own)
	root.add_child(view)
	var up := Vector3.BACK if absf((target - eye).normalized().y) > 0.9 else Vector3.UP
	camera.look_at_from_position(eye, target, up)
	return view

func surface(albedo: float) -> StandardMaterial3D:
	var material := StandardMaterial3D.new()
	material.albedo_color = Color(albedo, albedo, albedo).linear_to_srgb()
	material.roughness = 1.0
	material.metallic_specular = 0.0
	material.specular_mode = BaseMaterial3D.SPECULAR_DISABLED
	return material

func mesh(view: Node, own: PrimitiveMesh, material: Material, at := Vector3.ZERO) -> MeshInstance3D:
	var node := MeshInstance3D.new()
	node.mesh = own
	own.material = material
	node.position = at
	view.add_child(node)
	return node

func box(view: Node, size: Vector3, material: Material, at: Vector3) -> MeshInstance3D:
	var own := BoxMesh.new()
	own.size = size
	return mesh(view, own, material, at)

# The inside of a sphere.
func shell(view: Node, radius: float, material: Material) -> MeshInstance3D:
	var own := SphereMesh.new()
	own.radius = radius
	own.height = 2.0 * radius
	own.radial_segments = 64
	own.rings = 32
	own.flip_faces = true
	return mesh(view, own, material)

func node(view: Node, settings := {}) -> PatchlightGI:
	var gi := PatchlightGI.new()
	gi.wait = true
	gi.patch_count = 600
	for key in settings:
		gi.set(key, settings[key])
	view.add_child(gi)
	return gi

# Frames until what is shown is that of now.
func settle(frames := 6) -> void:
	for k in frames:
		await process_frame

func shown(view: SubViewport) -> float:
	await settle()
	await RenderingServer.frame_post_draw
	var image := view.get_texture().get_image()
	image.convert(Image.FORMAT_RGBAF)
	var sum := 0.0
	for y in range(16, 48):
		for x in range(16, 48):
			sum += image.get_pixel(x, y).r
	return sum / 1024.0

func end(view: Node) -> void:
	view.queue_free()
	await settle(2)

func bakes_tell_how_far_they_are() -> void:
	var view := world(Vector3(0, 1, 0), Vector3.ZERO)
	shell(view, 2.0, surface(0.5))
	var lamp := OmniLight3D.new()
	lamp.omni_attenuation = 2.0
	view.add_child(lamp)
	var gi := node(view, {"wait": false})
	var heard: Array[float] = []
	gi.lit.connect(func(progress: float) -> void: heard.push_back(progress))
	while heard.is_empty() or heard[-1] < 1.0:
		await process_frame
	expect(gi.progress == 1.0 and gi.patches >= 300 and gi.updates > 0, "the bake is whole: %d patches" % gi.patches)
	expect(heard.size() > 1 and heard == heard.duplicate().filter(func(x): return x > 0.0), "levels come: %s" % [heard])
	# A node that goes while it bakes takes its thread along.
	gi.bake()
	await end(view)

func what_cannot_be_lit_says_why() -> void:
	var view := world(Vector3(0, 1, 0), Vector3.ZERO)
	var gi := node(view)
	var reasons: Array[String] = []
	gi.failed.connect(func(reason: String) -> void: reasons.push_back(reason))
	await settle(3)
	expect(reasons.size() == 1 and reasons[0].contains("triangle"), "no triangles: %s" % [reasons])
	shell(view, 2.0, surface(0.5))
	gi.texel = -1.0
	gi.bake()
	expect(reasons.size() == 2 and reasons[1].contains("texel"), "no texel: %s" % [reasons])
	await end(view)

func light_follows_lamps_for_many_frames() -> void:
	var view := world(Vector3(0, 0, 0), Vector3(0, 0, -1))
	shell(view, 2.0, surface(0.5))
	var lamp := OmniLight3D.new()
	lamp.omni_attenuation = 2.0
	view.add_child(lamp)
	var gi := node(view, {"probe_count": 64})
	await settle(4)
	var before := gi.updates
	var memory := 0
	for frame in 300:
		lamp.position.x = 0.5 * sin(0.1 * frame)
		await process_frame
		if frame == 100:
			memory = OS.get_static_memory_usage()
	expect(gi.updates - before >= 299, "%d updates in 300 frames" % (gi.updates - before))
	var growth := OS.get_static_memory_usage() - memory
	expect(growth < 1 << 20, "memory grows by %d bytes" % growth)
	before = gi.updates
	await settle(10)
	expect(gi.updates - before <= 1, "what rests is not found anew")
	await end(view)

# A lamp of intensity π e in the middle of a sphere of reflectance ρ: what is reflected once and more is ρ / (1 − ρ) of what
# comes from the lamp itself.
func a_sphere_round_a_lamp_has_the_light_of_the_closed_form() -> void:
	var view := world(Vector3.ZERO, Vector3(1, 0.3, 0.2))
	shell(view, 2.0, surface(0.6))
	var lamp := OmniLight3D.new()
	lamp.omni_attenuation = 2.0
	lamp.omni_range = 1000.0
	lamp.light_energy = 1.5
	view.add_child(lamp)
	var direct := await shown(view)
	near(direct, 0.6 * 1.5 / 4.0, 0.02, "Godot's own light of the lamp")
	node(view)
	near(await shown(view), direct / (1.0 - 0.6), 0.03, "a sphere with a lamp, all bounces")
	lamp.light_energy = 3.0
	near(await shown(view), 2.0 * direct / (1.0 - 0.6), 0.03, "with twice the energy")
	await end(view)

func a_spot_in_a_sphere_fills_it_by_its_flux() -> void:
	# Away from the spot's light.
	var view := world(Vector3.ZERO, Vector3(0, 0, 1))
	shell(view, 2.0, surface(0.6))
	var spot := SpotLight3D.new()
	spot.spot_attenuation = 2.0
	spot.spot_range = 1000.0
	spot.spot_angle = 40.0
	spot.spot_angle_attenuation = 0.7
	view.add_child(spot)
	node(view)
	# Flux over intensity: ∫ 2π (1 − ((1 − c) / (1 − c₀))ᵏ) dc = 2π (1 − c₀) k / (k + 1).
	var c := cos(deg_to_rad(40.0))
	var flux := PI * TAU * (1.0 - c) * 0.7 / 1.7
	var irradiance := flux / (4.0 * PI * 4.0) * 0.6 / (1.0 - 0.6)
	near(await shown(view), 0.6 * irradiance / PI, 0.04, "a sphere with a spot, beside its light")
	await end(view)

# A white ball in that sphere has all light of its walls, ρ E / (1 − ρ) / π, round about.
func what_moves_has_the_light_of_its_place() -> void:
	var view := world(Vector3(0, 1.6, 0), Vector3(0, 0.8, 0))
	shell(view, 2.0, surface(0.6))
	var lamp := OmniLight3D.new()
	lamp.omni_attenuation = 2.0
	lamp.omni_range = 1000.0
	lamp.light_cull_mask = 2
	view.add_child(lamp)
	var ball := SphereMesh.new()
	ball.radius = 0.3
	ball.height = 0.6
	var moving := mesh(view, ball, surface(0.8), Vector3(0, 0.8, 0))
	moving.gi_mode = GeometryInstance3D.GI_MODE_DYNAMIC
	# Beside the frames, so that probes come later than all else.
	var gi := node(view, {"probe_count": 512, "wait": false})
	while gi.progress < 1.0:
		await process_frame
	gi.wait = true
	var expected := 0.8 * 0.6 / (1.0 - 0.6) / 4.0
	near(await shown(view), expected, 0.08, "a ball that moves")
	# It rests while the light changes.
	lamp.light_energy = 2.0
	near(await shown(view), 2.0 * expected, 0.08, "the ball in twice the light")
	# What hides light hides it from the probes about it, too.
	moving.add_to_group("patchlight_moving")
	gi.bake()
	near(await shown(view), 2.0 * expected, 0.2, "the ball, which hides light itself")
	# Near a corner of the room of probes as well.
	moving.position = Vector3(-0.7, -0.8, -0.7)
	view.get_camera_3d().position = Vector3(-0.7, 0.0, -0.7)
	near(await shown(view), 2.0 * expected, 0.2, "the ball elsewhere")
	await end(view)

# A ball under a bright panel has light from above, F L, and none from below.
func what_moves_knows_where_light_comes_from() -> void:
	var view := world(Vector3(0, 0.7, 0), Vector3.ZERO)
	var panel := surface(0.01)
	panel.emission_enabled = true
	panel.emission = Color.WHITE
	box(view, Vector3(2, 0.05, 2), panel, Vector3(0, 1.025, 0))
	box(view, Vector3(2, 0.05, 2), surface(0.01), Vector3(0, -1.025, 0))
	var ball := SphereMesh.new()
	ball.radius = 0.1
	ball.height = 0.2
	var moving := mesh(view, ball, surface(0.8))
	moving.gi_mode = GeometryInstance3D.GI_MODE_DYNAMIC
	node(view, {"probe_count": 1000})
	view.get_camera_3d().fov = 5
	var part := 1.0 / sqrt(2.0)
	near(await shown(view), 0.8 * 4.0 / TAU * 2.0 * part * atan(part), 0.1, "a ball from above")
	view.get_camera_3d().look_at_from_position(Vector3(0, -0.7, 0), Vector3.ZERO, Vector3.BACK)
	expect(await shown(view) < 0.03, "no light comes from below")
	view.get_camera_3d().look_at_from_position(Vector3(0.7, 0, 0), Vector3.ZERO, Vector3.UP)
	var beside := await shown(view)
	expect(beside > 0.05 and beside < 0.25, "some comes from the side: %f" % beside)
	await end(view)

# The wall gets ρ F of the sun on the floor; F between a place of the wall, 0.5 m above its foot, and a floor of 6 by 4 m.
func a_wall_by_a_sunlit_floor_has_the_light_of_the_closed_form() -> void:
	var view := world(Vector3(0, 0.5, 2), Vector3(0, 0.5, 0))
	box(view, Vector3(6, 0.1, 4), surface(0.5), Vector3(0, -0.05, 2))
	box(view, Vector3(6, 3, 0.1), surface(0.001), Vector3(0, 1.5, -0.05))
	var sun := DirectionalLight3D.new()
	sun.rotation = Vector3(-PI / 2, 0, 0)
	sun.light_energy = 2.0
	view.add_child(sun)
	node(view, {"patch_count": 1500, "texel": 0.05})
	var black := await shown(view)
	expect(black > 0.0, "the wall has light")
	var width := 3.0
	var factor := 0.0
	# Two halves of the floor, each with its corner under the place.
	var x := 4.0 / width
	var y := 0.5 / width
	factor = 2.0 / TAU * (atan(1.0 / y) - y / sqrt(x * x + y * y) * atan(1.0 / sqrt(x * x + y * y)))
	near(black, 0.001 * 2.0 * 0.5 * factor, 0.05, "a wall by a floor in the sun")
	await end(view)

# Radiance L over a whole sky gives a floor L; a panel of radiance L gives F L more.
func a_floor_under_a_bright_panel_and_a_sky() -> void:
	var view := world(Vector3(0, 0.4, 0), Vector3.ZERO)
	box(view, Vector3(4, 0.1, 4), surface(0.5), Vector3(0, -0.05, 0))
	var environment: Environment = view.get_node("Environment").environment
	environment.background_color = Color(0.5, 0.5, 0.5).linear_to_srgb()
	environment.background_energy_multiplier = 2.0
	var gi := node(view, {"texel": 0.05})
	near(await shown(view), 0.5, 0.03, "a floor under an even sky")
	environment.background_mode = Environment.BG_SKY
	var sky := Sky.new()
	var own := ProceduralSkyMaterial.new()
	own.sky_top_color = Color(0.5, 0.5, 0.5).linear_to_srgb()
	own.sky_horizon_color = own.sky_top_color
	own.ground_horizon_color = Color.BLACK
	own.ground_bottom_color = Color.BLACK
	sky.sky_material = own
	environment.sky = sky
	environment.background_energy_multiplier = 1.0
	gi.update_sky()
	near(await shown(view), 0.5 * 0.5, 0.06, "a floor under a sky of a shader")
	environment.background_mode = Environment.BG_COLOR
	environment.background_color = Color.BLACK
	gi.update_sky()
	var panel := surface(0.01)
	panel.emission_enabled = true
	panel.emission = Color.WHITE
	panel.emission_energy_multiplier = 3.0
	box(view, Vector3(2, 0.05, 2), panel, Vector3(0, 1.025, 0))
	gi.bake()
	# Four quarters, each from above its corner.
	var side := 1.0
	var part := side / sqrt(1.0 + side * side)
	var factor := 4.0 / TAU * 2.0 * part * atan(part)
	near(await shown(view), 0.5 * 3.0 * factor, 0.04, "a floor under a bright panel")
	await end(view)
