# Stage 30: contact kinematics and CalculiX, shard by shard.
FEA := $(SHARDS:%=$D/30_fea/%.csv)

.PHONY: fea
fea: $(FEA) $(call barrier,30_fea)  ## solve every accepted sample by finite elements

fea_of = gelforge.stages.fea --poses $1/10_poses/$2.csv --meshes $D/20_meshes $(if $(MESHES),--chosen $1/20_meshes/$2.csv) \
    --params $P/fea.json --out $1/30_fea/$2.csv

$(FEA): $D/30_fea/%.csv: $D/10_poses/%.csv $P/fea.json $(if $(MESHES),$D/20_meshes/%.csv) \
    | $(IMAGES_JUDGED) $(call barrier,10_poses 20_meshes)
	$(call step,$(call fea_of,$D,$*).part)

.PHONY: deck
deck:  ## CalculiX' deck of one sample as a self-contained folder: make deck ID=…
	@$(PY) -m gelforge.commands.deck --results $D --id $(call given,ID)
