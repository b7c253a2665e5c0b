# A room of two halves, whose sun goes round, whose lamp can be switched, and through which a ball wanders.
# Keys: space stops the sun, L switches the lamp, arrows and the mouse look round.
extends Node3D

const WALL := Color(0.82, 0.8, 0.76)

var sun: DirectionalLight3D
var lamp: OmniLight3D
var ball: MeshInstance3D
var camera: Camera3D
var gi: PatchlightGI
var text: Label
var time := 0.0
var moves := true
var look := Vector2(-0.55, -0.12)

func _ready() -> void:
	var grey := surface(WALL)
	box("floor", Vector3(0, -0.1, 0), Vector3(8, 0.2, 6), surface(Color(0.5, 0.36, 0.25)))
	box("ceiling", Vector3(0, 3.1, 0), Vector3(8, 0.2, 6), grey)
	box("left", Vector3(-4.1, 1.5, 0), Vector3(0.2, 3, 6), surface(Color(0.75, 0.2, 0.15)))
	box("right", Vector3(4.1, 1.5, 0), Vector3(0.2, 3, 6), surface(Color(0.2, 0.5, 0.25)))
	box("back", Vector3(0, 1.5, -3.1), Vector3(8.4, 3, 0.2), grey)
	# The front is open over a sill, from pillar to pillar.
	box("sill", Vector3(0, 0.4, 3.1), Vector3(8.4, 0.8, 0.2), grey)
	box("lintel", Vector3(0, 2.8, 3.1), Vector3(8.4, 0.4, 0.2), grey)
	for k in 4:
		box("pillar %d" % k, Vector3(-4.0 + k * 8.0 / 3.0, 1.7, 3.1), Vector3(0.4, 1.8, 0.2), grey)
	box("partition", Vector3(0.4, 1.5, -1.2), Vector3(0.15, 3, 3.6), grey)
	box("table", Vector3(2.4, 0.7, -0.5), Vector3(1.4, 0.08, 0.9), surface(Color(0.6, 0.45, 0.3)))
	for x in [1.8, 3.0]:
		box("leg %.1f" % x, Vector3(x, 0.33, -0.5), Vector3(0.08, 0.66, 0.8), surface(Color(0.6, 0.45, 0.3)))
	box("shelf", Vector3(-3.2, 0.9, -2.7), Vector3(1.2, 1.8, 0.5), surface(Color(0.3, 0.4, 0.55)))

	ball = MeshInstance3D.new()
	ball.mesh = SphereMesh.new()
	ball.mesh.radius = 0.35
	ball.mesh.height = 0.7
	ball.mesh.radial_segments = 24
	ball.mesh.rings = 12
	ball.mesh.material = surface(Color(0.85, 0.85, 0.85))
	ball.gi_mode = GeometryInstance3D.GI_MODE_DYNAMIC
	ball.add_to_group("patchlight_moving")
	add_child(ball)

	sun = DirectionalLight3D.new()
	sun.shadow_enabled = true
	sun.light_energy = 3.0
	sun.light_color = Color(1.0, 0.95, 0.86)
	add_child(sun)
	lamp = OmniLight3D.new()
	lamp.position = Vector3(2.4, 2.5, -1.5)
	lamp.omni_range = 12.0
	lamp.omni_attenuation = 2.0
	lamp.light_energy = 0.8
	lamp.light_color = Color(1.0, 0.75, 0.5)
	lamp.shadow_enabled = true
	add_child(lamp)

	var environment := Environment.new()
	environment.background_mode = Environment.BG_COLOR
	environment.background_color = Color(0.5, 0.68, 0.9)
	environment.background_energy_multiplier = 0.7
	environment.ambient_light_source = Environment.AMBIENT_SOURCE_DISABLED
	environment.tonemap_mode = Environment.TONE_MAPPER_AGX
	environment.tonemap_exposure = 1.8
	var world := WorldEnvironment.new()
	world.environment = environment
	add_child(world)

	camera = Camera3D.new()
	camera.position = Vector3(-2.6, 1.6, 2.6)
	camera.fov = 75
	add_child(camera)
	text = Label.new()
	text.position = Vector2(16, 12)
	add_child(text)

	gi = PatchlightGI.new()
	gi.texel = 0.06
	add_child(gi)
	place()

func surface(color: Color) -> StandardMaterial3D:
	var material := StandardMaterial3D.new()
	material.albedo_color = color
	material.roughness = 1.0
	material.metallic_specular = 0.0
	return material

func box(called: String, at: Vector3, size: Vector3, material: Material) -> void:
	var node := MeshInstance3D.new()
	node.name = called
	node.mesh = BoxMesh.new()
	node.mesh.size = size
	node.mesh.material = material
	node.position = at
	add_child(node)

func place() -> void:
	sun.rotation = Vector3(-0.55 - 0.15 * sin(0.3 * time), 0.7 * sin(0.2 * time), 0)
	ball.position = Vector3(-1.6 + 1.2 * sin(0.5 * time), 0.35, 0.8 + 0.8 * cos(0.5 * time))
	camera.rotation = Vector3(look.y, look.x, 0)

func _process(delta: float) -> void:
	if moves:
		time += delta
	look -= 1.5 * delta * Input.get_vector("ui_left", "ui_right", "ui_down", "ui_up") * Vector2(1, -1)
	place()
	var share := "" if gi.progress == 1.0 else ", bake %d %%" % int(100.0 * gi.progress)
	text.text = "%d frames a second; light in %.0f ms, %d patches%s" % [
		Engine.get_frames_per_second(), gi.update_time, gi.patches, share]

func _unhandled_input(event: InputEvent) -> void:
	if event is InputEventKey and event.pressed and not event.echo:
		match event.keycode:
			KEY_SPACE:
				moves = not moves
			KEY_L:
				lamp.visible = not lamp.visible
	elif event is InputEventMouseMotion and event.button_mask != 0:
		look -= 0.004 * event.relative
